"""Compiled functions and the devices that run them.

`kernel` makes a function of one lane (a row of a batch) a compiled function of many; `batching` pads and refills
batches; `programs` compiles ahead and keeps the executables; `devices` chooses CPU or GPU; `processes` shares
scenarios among worker processes. A row's result does not depend on the other rows of its batch.
"""
