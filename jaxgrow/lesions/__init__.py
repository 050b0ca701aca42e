"""Kinds of lesion, one a file: what is asked for, who divides, how size is measured."""
