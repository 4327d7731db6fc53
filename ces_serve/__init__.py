"""A page to browse what is in a folder: models, reports, campaigns, diagnoses, recordings, searches, a live observer."""
