"""HTCP in JAX: position-only path tracking inside narrow parts, batched over scenarios, with hard constraints."""

import jax

# Clearances of 0.1 mm decide results; 32-bit floats carry 0.1 um at 2 m, and the step QPs lose more. Once, here.
jax.config.update("jax_enable_x64", True)
