"""The formats of logs, a module each: tables whose rows share a time, and logs whose channels have their own times."""
