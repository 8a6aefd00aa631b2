"""What any program needs: errors in one sentence, files, processes, MPI, plugins found."""
