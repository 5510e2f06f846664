"""Planning methods. `batch.plan` plans scenarios with any of them and reports its `Progress`.

A `Method` has a name, a title, a description and a function `plan` from a `motion.Problem` to `motion.Plans`.
`registry` has the names and descriptions of all methods, including those of other packages; `extensions.register` adds
a method, a kind of obstacle or a kind of task row. `methods` has the built-in methods, and finds any method by its
name; importing it loads JAX and all lane functions, which `registry` does not. `batch` checks the start, calls the
method, verifies the segments and, if required, smooths the motion: results have the same guarantees with every method.

There are two families of methods, each in a package. `beam`, for this package only, is a beam search that keeps several
configurations per target. `planning.tracking` follows the path by step QPs and, when stuck, tries recoveries in the
null space of the task, as the paper does.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
