"""Sequencing: the order of a part's seams, the direction of each, and the proven motion through all of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
