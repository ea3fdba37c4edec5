//! The card of the trained parts.

use sage_backbones::parameters::Header;
use serde_json::Value;

/// File of the card.
pub(super) const FILE: &str = "README.md";

/// The page: how the parts were trained, and what was measured.
pub(super) fn page(header: &Header, summary: &Value) -> String {
    let [counts, trained, measured] = ["counts", "trained", "measured"].map(|key| &summary[key]);
    let number = |value: &Value| value.as_f64().map_or("—".to_owned(), |x| format!("{x:.3}"));
    let estimate =
        |value: &Value| match (value["value"].as_f64(), value["low"].as_f64(), value["high"].as_f64()) {
            (Some(x), Some(low), Some(high)) => format!("{x:.3} [{low:.3}, {high:.3}], n = {}", value["n"]),
            _ => "—".to_owned(),
        };
    let skills = &trained["skills"]["best"];
    let rows = [
        ("command", format!("`{}`", header.command)),
        ("licence", header.license.clone()),
        ("scenes", header.data.clone()),
        ("seed", header.seed.to_string()),
        (
            "roll-outs",
            format!(
                "{} without an attack ({} ended in a contact), {} against candidates ({})",
                counts["unattacked"],
                counts["unattacked_contacts"],
                counts["attacked"],
                counts["attacked_contacts"]
            ),
        ),
        (
            "windows",
            format!(
                "{} of ordinary driving, {} that start in the last 20 steps before a contact",
                counts["windows"], counts["windows_before_contact"]
            ),
        ),
        (
            "examples of the score",
            format!("{} candidates, {} other vehicles", counts["candidates"], counts["others"]),
        ),
        (
            "score: best epoch",
            format!(
                "{} of {}, mean squared error {}",
                trained["criticality"]["best"]["epoch"],
                trained["criticality"]["epochs"],
                number(&trained["criticality"]["best"]["validation"])
            ),
        ),
        (
            "skills: best epoch",
            format!(
                "{} of {}, R² of steering {}, of throttle {}",
                skills["epoch"],
                trained["skills"]["epochs"],
                number(&skills["steering"]),
                number(&skills["throttle"])
            ),
        ),
        ("skill distributions: numbers", format!("{} each", trained["adversarial"]["parameters"])),
        (
            "rank correlation with the measured collision score in a scene: learned",
            estimate(&measured["rank"]["learned"]),
        ),
        ("CAT's score", estimate(&measured["rank"]["cat"])),
        ("R_adv", estimate(&measured["rank"]["r_adv"])),
        ("learned less CAT's", estimate(&measured["rank"]["learned_less_cat"])),
        ("learned less R_adv", estimate(&measured["rank"]["learned_less_r_adv"])),
        (
            "decoded skill against the drive, 10 steps: median of the farthest distance, m",
            estimate(&measured["decoded_distance"]),
        ),
        (
            "contacts of adversaries with skills before contacts",
            estimate(&measured["contacts"]["adversarial"]),
        ),
        ("with skills of ordinary driving", estimate(&measured["contacts"]["benign"])),
        ("difference", estimate(&measured["contacts"]["difference"])),
    ];
    let rows: String = rows.iter().map(|(name, value)| format!("| {name} | {value} |\n")).collect();
    format!(
        "# Learned parts of SEAL\n\n`seal.safetensors` holds the score, the decoder of skills and the distribution of skills before contacts; copy it beside the prior.\n\n| | |\n| --- | --- |\n{rows}"
    )
}
