"""Planning methods: `batch.plan` plans scenarios by any of them.

`registry` finds methods by name, those of other packages among them; `methods` has the built-in ones. Two families,
each a package: `beam` keeps several configurations per target (beam search over configurations), `tracking` follows the
path by step QPs and, when stuck, tries recoveries in the null space of the task, as the paper does.
"""
