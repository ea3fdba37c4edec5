//! The recipe that several tests merge.

/// The mean of the two experts of a folder.
pub fn linear(experts: &str) -> String {
    let model =
        |name: &str| format!("  - model: {experts}/{name}.safetensors\n    parameters: {{weight: 0.5}}\n");
    let models = model("realistic") + &model("adversarial");
    format!("merge_method: linear\nbase_model: {experts}\nmodels:\n{models}")
}
