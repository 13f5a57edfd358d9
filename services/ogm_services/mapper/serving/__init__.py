"""What the mapper answers, over HTTP and Zenoh."""
