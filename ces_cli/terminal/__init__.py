"""What all programs share: options and exit status, reading of recordings, tables, pictures and progress."""
