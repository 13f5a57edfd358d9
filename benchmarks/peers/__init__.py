"""Other programs of the map's kind: small C++ programs that map a workload, and what runs them."""
