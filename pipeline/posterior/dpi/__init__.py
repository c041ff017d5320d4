"""Diffusion posterior illumination (DPI, Lyu et al. 2023): as published, as released, and its
ablation without sampling.
"""
