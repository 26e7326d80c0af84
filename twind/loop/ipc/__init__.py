"""Inter-process communication of the loop with its front process."""
