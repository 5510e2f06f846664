"""What is kept: plans and sweeps on disk, written whole, found again by hash; made here or on a cluster."""
