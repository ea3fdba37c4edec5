//! Devices by name.

use candle_core::Device;

use crate::{Backbone, Error};

/// The device of a name: `cpu`, or `cuda` and `cuda:N` in a program that is built with the feature `cuda`.
///
/// *Errors*: [`Error::Option`] for another name, and for a device that there is not.
pub fn device(name: &str) -> Result<Device, Error> {
    let number = match name.strip_prefix("cuda") {
        None if name == "cpu" => return Ok(Device::Cpu),
        Some("") => Some(0),
        Some(rest) => rest.strip_prefix(':').and_then(|number| number.parse().ok()),
        None => None,
    };
    let number =
        number.ok_or_else(|| Error::Option(format!("device `{name}`; expected cpu, cuda or cuda:N")))?;
    if !candle_core::utils::cuda_is_available() {
        return Err(Error::Option(format!("device `{name}` needs a build with `--features cuda`")));
    }
    Device::new_cuda(number).map_err(|error| Error::Option(format!("device `{name}`: {error}")))
}

/// What decides which operations a network takes on a device: `cpu`, `cuda` or `metal`.
pub fn kind(device: &Device) -> &'static str {
    match device {
        Device::Cpu => "cpu",
        Device::Cuda(_) => "cuda",
        Device::Metal(_) => "metal",
    }
}

/// A network on a device, without gradients to the original.
///
/// *Errors*: those of the device.
pub fn on(network: &dyn Backbone, device: &Device) -> Result<Box<dyn Backbone>, Error> {
    network.with_parameters(network.parameters().to_device(device)?)
}

#[cfg(test)]
mod tests {
    use super::device;

    #[test]
    fn devices_have_names_and_others_are_refused_with_the_remedy() {
        assert!(device("cpu").unwrap().is_cpu());
        for name in ["", "gpu", "cuda:x", "cuda1", "cuda:-1"] {
            let error = device(name).unwrap_err().to_string();
            assert_eq!(error, format!("device `{name}`; expected cpu, cuda or cuda:N"));
        }
        if !candle_core::utils::cuda_is_available() {
            assert_eq!(
                device("cuda:1").unwrap_err().to_string(),
                "device `cuda:1` needs a build with `--features cuda`"
            );
        }
    }
}
