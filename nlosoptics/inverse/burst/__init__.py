"""Objects behind rough walls, from many images through different speckle."""
