"""Result folders: locks, journals, marks, atomic files, progress."""
