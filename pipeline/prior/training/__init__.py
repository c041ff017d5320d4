"""Making the priors: data, procedural maps, training, export. No sampler imports from here."""
