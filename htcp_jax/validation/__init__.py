"""What is doubted: results measured again by MuJoCo alone, and held to baselines."""
