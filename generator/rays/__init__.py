"""First hits and their echoes: Mitsuba's geometry, rays, arrival times, sub-pixel sampling."""
