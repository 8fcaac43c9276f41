"""Recoveries to and from MCAP files."""
