//! Pictures and pages of traffic scenes.
//!
//! [`drawing`] draws a scene as SVG. [`player`] makes a page that plays drives, [`listing`] one that lists results with thumbnails and
//! filters; both are [self-contained](html_page). [`studio`] is the page of a server. Nothing here knows a command or a run.

pub mod drawing;
pub mod html_page;
pub mod listing;
pub mod player;
pub mod studio;
