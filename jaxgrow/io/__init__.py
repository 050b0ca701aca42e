"""What a run reads and writes: meshes, run folders, reports, audits."""
