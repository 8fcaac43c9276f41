"""Recordings from plain files, and tables of sensors."""
