"""Recordings from and to MCAP files."""
