"""A robot file from what an owner has: scans, files of other software, a model. The rest is asked."""
