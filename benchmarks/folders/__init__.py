"""Result folders: locks, journals, marks, whole files, progress."""
