"""What is run: a motion with time, and the files that controllers and simulators take it from."""
