"""Many diagnoses at once: recordings by vehicle go in, a row and a folder of files for each come out."""
