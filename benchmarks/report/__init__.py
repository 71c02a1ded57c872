"""The report page and what its tables, charts and sentences are made from."""
