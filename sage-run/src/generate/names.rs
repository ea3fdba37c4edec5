//! Names of the files of a run.

/// The page that lists all scenes.
pub(super) const INDEX: &str = "index.html";

/// Name of a row's file.
pub(super) fn row_file(scene: &str, variant: &str) -> String {
    format!("{scene}-{variant}.json")
}

/// Name of the picture of a scene.
pub(super) fn picture_file(scene: &str) -> String {
    format!("{scene}.svg")
}

/// Name of the page of a scene.
pub(super) fn page_file(scene: &str) -> String {
    format!("{scene}.html")
}
