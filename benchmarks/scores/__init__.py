"""Score tables: errors, failures and efficiency of estimates."""
