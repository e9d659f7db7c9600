//! Names and numbers of other data sets in the nuScenes layout.
