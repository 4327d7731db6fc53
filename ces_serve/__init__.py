"""Pages to browse a folder: models, reports, results, recordings, and searches while they run."""
