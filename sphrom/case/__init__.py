"""The case file: what may stand in it, reading it, and what follows from it."""
