"""Pages of the documentation site that are made from the code: commands, Python, files, captures, estimators."""
