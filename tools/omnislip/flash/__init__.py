"""Programs for the LF2407A: what is in a file, where it goes, and the way into the chip."""
