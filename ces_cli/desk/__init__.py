"""Pages to browse a folder: models, reports, results and recordings."""
