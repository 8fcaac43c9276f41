"""The MCAP container, read and written in flat memory."""
