"""Files of a run: meshes, run folders, reports, audits."""
