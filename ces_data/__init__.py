"""What was logged: bags, logs, mapping, checks. Recordings come out, with findings; no model is known here."""
