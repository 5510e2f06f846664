"""Planning methods: `batch.plan` plans scenarios by any of them.

`registry` finds methods by name, including those of other packages; `methods` has the built-in ones. There are two
families, each a package: `beam` keeps several configurations per target (beam search over configurations); `tracking`
follows the path by step QPs and, when stuck, tries recoveries in the null space of the task, as in the paper.
"""
