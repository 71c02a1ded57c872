"""The path tracer: light after several events, with its arrival times."""
