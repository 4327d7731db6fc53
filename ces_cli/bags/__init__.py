"""The programs about recordings: `info`, `signals`, `import`, `characterise`, `replay`, `simulate`, `export-data`."""
