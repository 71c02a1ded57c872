"""beambench."""
