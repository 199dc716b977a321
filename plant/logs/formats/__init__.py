"""Readers of file formats for the child process; they import only each other.

Each has ``read(path, names, prefix, max_bytes, ...)``, which returns the names of all columns and a
dictionary of those that are wanted. What reads the file is imported late, once the child has
limited its memory and time.
"""
