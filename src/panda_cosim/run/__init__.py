"""How it comes about: a scenario is prepared, stepped and concluded."""
