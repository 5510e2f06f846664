"""Path tracking by step QPs, with recoveries that move in the null space of the task (Algorithm 1 of the paper).

`engine` advances a batch of scenarios, whatever phase each of them is in; `stages` are the recoveries, tried in order;
`null_space` is one null-space step, `sampling` draws candidates.
"""
