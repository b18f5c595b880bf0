"""The command line: commands are listed in `main.COMMANDS`, with their modules; the benchmarks are a package."""
