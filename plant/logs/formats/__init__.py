"""Readers of file formats, one file each, for the child process: they import nothing of this
project but each other.

Each has ``read(path, names, prefix, most, ...)``, which returns the names of all columns and a
dictionary of those that are wanted. What reads the file is imported late, once the child has
limited its memory and time.
"""
