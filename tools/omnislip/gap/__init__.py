"""The gap workflow: where do model and logs disagree, what is missing, does adding it help."""
