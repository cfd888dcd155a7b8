"""Hostile input for everything that imgloc reads."""
