"""A fleet: one diagnosis for each recording or vehicle, here or on a cluster, streamed to disk and resumed."""
