"""Walls: `kinds` lists the wall rules, `rule` has their common code, `rules` a class for each."""
