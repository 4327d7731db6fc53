"""The pages: requests in, HTML and streams of events out. Flask is imported in this room alone."""
