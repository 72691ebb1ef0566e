"""The case file: its keys, reading and checking it, and the quantities derived from it."""
