"""`python -m ogm_services` is `ogm`."""

from ogm_services.cli import main

main()
