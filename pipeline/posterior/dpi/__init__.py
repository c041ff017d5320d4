"""Diffusion posterior illumination (Lyu et al. 2023) as published, as released, and its
ablation.
"""
