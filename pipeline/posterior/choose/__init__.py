"""How much model a scene needs, decided from its photos and surface before anything is fitted."""
