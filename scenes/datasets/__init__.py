"""Data sets: distributions of scenes, drawn capture by capture, and split so that no scene is in two parts."""
