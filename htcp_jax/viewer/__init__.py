"""What is seen of plans: pictures, movies, and the page in the browser."""
