"""Kinds of lesion, one per file: request, division rule and size."""
