"""Runs many jobs, saves each result as a row and files as soon as the job ends, and resumes after an interruption.

Campaigns of identifications and fleets of diagnoses run on this engine, on one machine or on a Dask cluster.
"""
