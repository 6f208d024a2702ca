"""Data sets of other people and recordings: read into one form, checked against their own pictures, made into samples.

`layout` says how a folder is laid out, `annotated` and `bop_parts` read it, `checks` and `recorded_checks` compare what
it says with what its pictures show (`evidence`), `labelled` gives the instances that `samples` makes records of.
"""
