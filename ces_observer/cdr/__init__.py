"""Numbers read from and written to serialised messages (CDR) without deserialising them."""
