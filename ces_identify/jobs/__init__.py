"""Many jobs, streamed to disk and resumed: jobs go in, their results come out as rows and files as each job ends.

Campaigns of identifications and fleets of diagnoses run on this engine, on one machine or on a Dask cluster.
"""
