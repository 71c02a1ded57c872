"""Recording: plans, the shots that they ask for, and the stack that is on disk shot by shot."""
