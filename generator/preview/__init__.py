"""Pictures of a scene for people, by a second renderer."""
