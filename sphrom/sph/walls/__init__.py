"""Walls: `kinds` lists their rules, `rule` has the common code, `rules` has a class of each."""
