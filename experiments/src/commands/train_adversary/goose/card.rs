//! The card of the policy.

use sage_backbones::parameters::Header;
use serde_json::Value;

/// File of the card.
pub(super) const FILE: &str = "README.md";

/// The page: how the policy was trained, and what was measured.
pub(super) fn page(header: &Header, driver: &str, summary: &Value) -> String {
    let estimate =
        |value: &Value| match (value["value"].as_f64(), value["low"].as_f64(), value["high"].as_f64()) {
            (Some(x), Some(low), Some(high)) => {
                let [x, low, high] = [x, low, high].map(|share| 100.0 * share);
                format!("{x:.1} [{low:.1}, {high:.1}], n = {}", value["n"])
            }
            _ => "—".to_owned(),
        };
    let mut rows = vec![
        ("command".to_owned(), format!("`{}`", header.command)),
        ("licence".to_owned(), header.license.clone()),
        ("scenes".to_owned(), header.data.clone()),
        ("driver".to_owned(), driver.to_owned()),
        ("seed".to_owned(), header.seed.to_string()),
        (
            "decisions, scenes that ended".to_owned(),
            format!("{}, {}", summary["decisions"], summary["ended"]),
        ),
        ("goal reached in the first fifth of the training, %".to_owned(), estimate(&summary["success"][0])),
        ("in the last fifth".to_owned(), estimate(&summary["success"][1])),
        ("last less first".to_owned(), estimate(&summary["success"][2])),
    ];
    for (against, named) in
        [("driver", "against the driver of the training"), ("recording", "against the ego's recording")]
    {
        let measured = &summary["measured"][against];
        for (who, whose) in [
            ("policy", "the policy"),
            ("random", "random actions"),
            ("unchanged", "the curve through the recording"),
        ] {
            let both = ["hit", "goal"].map(|what| estimate(&measured[who][what]));
            let [hit, goal] = both;
            rows.push((format!("{named}, {whose}: contact; goal reached, %"), format!("{hit}; {goal}")));
        }
        rows.push((
            format!("{named}: contacts of the policy less those of random actions, points"),
            estimate(&measured["hits_over_random"]),
        ));
    }
    let rows: String = rows.iter().map(|(name, value)| format!("| {name} | {value} |\n")).collect();
    format!(
        "# Policy of GOOSE\n\n`goose.safetensors` holds the encoder of drives and the actor that moves the control points; copy it beside the prior. The picture `success.svg` shows the training.\n\n| | |\n| --- | --- |\n{rows}"
    )
}
