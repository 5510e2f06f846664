"""Planning: escapes, the engine that advances a batch of scenarios, the methods, and the plans they make."""
