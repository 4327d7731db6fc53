"""Many diagnoses at once: recordings by vehicle in, a row and a folder of files for each out."""
