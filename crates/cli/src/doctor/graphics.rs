//! Check of graphics adapters, which compute haptic textures and draw the window of `palpate view`.

use palpate::texture_pd::wgpu::{AdapterInfo, DeviceType};

use super::finding::{Finding, Verdict};

const NAME: &str = "graphics adapters";

pub fn finding() -> Finding {
    verdict_on(&palpate::texture_pd::adapters())
}

fn verdict_on(adapters: &[AdapterInfo]) -> Finding {
    let remedy = "install the driver of your graphics card (Vulkan on Linux); without one, textures are computed on the processor, \
                  and `palpate view` needs a software driver such as lavapipe";
    if adapters.is_empty() {
        let seen = "no adapter answers to Vulkan, Metal or Direct3D 12".to_owned();
        return Finding::new(NAME, Verdict::CouldBeBetter, seen).with_remedy(remedy);
    }
    let hardware = |info: &&AdapterInfo| {
        matches!(
            info.device_type,
            DeviceType::DiscreteGpu | DeviceType::IntegratedGpu | DeviceType::VirtualGpu
        )
    };
    let kind = |info: &AdapterInfo| match info.device_type {
        DeviceType::DiscreteGpu => "graphics card",
        DeviceType::IntegratedGpu => "integrated graphics",
        DeviceType::VirtualGpu => "virtual graphics",
        DeviceType::Cpu => "software",
        DeviceType::Other => "kind unknown",
    };
    let names: Vec<String> =
        adapters.iter().map(|info| format!("{} ({}, {})", info.name, kind(info), info.backend)).collect();
    if adapters.iter().any(|info| hardware(&info)) {
        Finding::new(NAME, Verdict::Good, names.join("; "))
    } else {
        Finding::new(NAME, Verdict::CouldBeBetter, names.join("; ")).with_remedy(remedy)
    }
}

#[cfg(test)]
mod tests {
    use palpate::texture_pd::wgpu::Backend;

    use super::*;

    #[test]
    fn a_software_driver_is_not_a_graphics_card() {
        let adapter = |name: &str, device_type| AdapterInfo {
            name: name.to_owned(),
            ..AdapterInfo::new(device_type, Backend::Vulkan)
        };
        let none = verdict_on(&[]);
        assert!(none.verdict == Verdict::CouldBeBetter && none.remedy.is_some());
        let software = verdict_on(&[adapter("slow", DeviceType::Cpu)]);
        assert_eq!(software.verdict, Verdict::CouldBeBetter);
        assert_eq!(software.measured, "slow (software, vulkan)");
        let both = verdict_on(&[adapter("slow", DeviceType::Cpu), adapter("fast", DeviceType::DiscreteGpu)]);
        assert_eq!(both.verdict, Verdict::Good);
        assert!(both.measured.contains("slow (software") && both.measured.contains("fast (graphics card"));
    }
}
