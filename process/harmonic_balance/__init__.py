"""Response to a sine with nonlinear elements: harmonic balance."""
