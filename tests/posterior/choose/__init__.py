"""Decisions on how much model a scene needs."""
