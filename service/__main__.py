"""`python -m matiere.service` is the command `matiere`."""

from matiere.service.cli import main

if __name__ == "__main__":
    main()
