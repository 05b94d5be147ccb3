"""Read files of other formats as recordings."""
