"""Pure geometry on arrays: link poses, convex shapes, footprints, broad phase."""
