"""The report: a diagnosis goes in, one self-contained HTML page for screen and paper comes out."""
