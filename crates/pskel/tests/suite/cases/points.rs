//! Point clouds of strangers: origins, colors, masks, values that are not finite.
