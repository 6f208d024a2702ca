"""Data sets of other people, read into one form and checked against their own pictures.

`layout` says how a folder is laid out, `annotated` reads it, `checks` compares what it says with what its depth shows.
"""
