"""Pages to browse a folder: models, reports, results and recordings; running searches and a running observer, live."""
