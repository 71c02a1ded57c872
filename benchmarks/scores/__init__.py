"""The score tables: errors, failures, efficiency, costs."""
