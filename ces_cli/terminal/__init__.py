"""Shared by all programs: options and exit status, reading of recordings, tables, pictures and progress."""
