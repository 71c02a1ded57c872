"""The report page: its tables, charts and sentences."""
