"""The programs that read and write recordings: `info`, `import`, `replay` and `simulate`."""
