"""GigE Vision in plain Python: the client's side of control (GVCP), images (GVSP) and the camera's own description."""
