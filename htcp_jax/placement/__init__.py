"""What is searched: ranges of a job's parameters, and the mountings in them that do the whole work, ranked."""
