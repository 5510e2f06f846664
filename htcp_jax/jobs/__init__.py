"""What is asked: a job's configuration, a grid of jobs, and the scene that they speak of."""
