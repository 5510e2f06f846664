"""Strict JAX for every test: ranks are never promoted in silence; compiled programs are kept between runs."""

import jax

from htcp_jax import compile_cache

jax.config.update("jax_numpy_rank_promotion", "raise")
compile_cache.enable()
