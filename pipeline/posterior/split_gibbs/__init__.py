"""The default sampler; sampler.py shows the whole loop."""
