"""What is looked at before anything is sliced: mesh, units, machine, settings and the work that the job will be."""
