"""Walls: `kinds` lists their rules, `rule` has what all share, `rules` has a class of each."""
