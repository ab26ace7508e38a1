"""From pictures to motion: cameras, rendering, correlation of pictures, places in space."""
