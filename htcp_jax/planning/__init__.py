"""Planning methods: `batch.plan` plans scenarios by any of them and reports its `Progress`.

A `Method` has a name, a title, a description and a function `plan` from a `motion.Problem` to `motion.Plans`.
`registry` finds methods by name, those of other packages among them, and `registry.register` adds one; `methods` has
the built-in ones, which are loaded when a method is looked up. `batch` checks the start, calls the method, verifies its
segments and, if required, smooths the motion: whatever the method, results have the same guarantees.
`start_clearance` is the clearance at the start alone.

Two families of methods, each a package: `beam`, for this package only, keeps several configurations per target (beam
search over configurations); `planning.tracking` follows the path by step QPs and, when stuck, tries recoveries in the
null space of the task, as the paper does.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
