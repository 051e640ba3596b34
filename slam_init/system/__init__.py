"""What the operating system gives: standard streams, processes, files of others, threads of libraries."""
