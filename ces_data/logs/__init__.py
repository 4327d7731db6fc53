"""Logs of dynos and loggers, a module for each format: tables whose rows share a time,."""
