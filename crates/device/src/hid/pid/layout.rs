//! Positions of PID fields in a device's reports, from its report descriptor ("Device Class Definition for
//! Physical Interface Devices", USB-IF 1999).
//!
//! Report numbers and field widths differ between devices; usages give the meaning of a field.

use hidparser::report_data_types::{PhysicalMaximum, PhysicalMinimum, Unit, UnitExponent, Usage};
use hidparser::{Report, ReportCollection, ReportField, VariableField, parse_report_descriptor};

use crate::hid::LONGEST_HID_REPORT;

/// Usage pages.
const DESKTOP: u16 = 0x01;
const BUTTON: u16 = 0x09;
const PID: u16 = 0x0f;

/// Duration of an effect that is not started anew, s: the force of a host that was killed ends by then.
pub const EFFECT_DURATION: f64 = 0.05;
/// Shortest usable duration, s: a shorter effect would end between two starts.
const MIN_EFFECT_DURATION: f64 = 0.03;

/// Largest number of axes that are sensed and driven.
pub const AXES: usize = 2;
/// Usages of X and Y on the desktop page.
const AXIS_USAGES: [u16; AXES] = [0x30, 0x31];
/// Largest number of buttons that are reported.
const BUTTONS: usize = 32;

/// An integer field of a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// First bit, counted with the byte of the report's number.
    first: usize,
    width: usize,
    pub minimum: i32,
    pub maximum: i32,
}

impl Slot {
    fn new(bits: &std::ops::Range<u32>, minimum: i32, maximum: i32) -> Option<Self> {
        // The first byte is the report's number.
        let (first, width) = (8 + bits.start as usize, bits.len());
        let sound = (1..=32).contains(&width) && first + width <= 8 * LONGEST_HID_REPORT && minimum < maximum;
        sound.then_some(Self { first, width, minimum, maximum })
    }

    /// Puts a number into a report, clamped to the field's range.
    pub fn put(&self, report: &mut [u8], value: i32) {
        let value = value.clamp(self.minimum, self.maximum) as u32;
        for bit in 0..self.width {
            let at = self.first + bit;
            let Some(byte) = report.get_mut(at / 8) else { return };
            let mask = 1 << (at % 8);
            *byte = if value >> bit & 1 == 1 { *byte | mask } else { *byte & !mask };
        }
    }

    /// The number in a report; `None` if the report ends before it.
    pub fn get(&self, report: &[u8]) -> Option<i32> {
        let mut value = 0_u32;
        for bit in 0..self.width {
            let at = self.first + bit;
            value |= u32::from(report.get(at / 8)? >> (at % 8) & 1) << bit;
        }
        // A field is signed if its minimum is negative: shift its sign bit to the top and back.
        let unused = 32 - self.width;
        let value = if self.minimum < 0 { (value << unused) as i32 >> unused } else { value as i32 };
        Some(value.clamp(self.minimum, self.maximum))
    }
}

/// A value of a field that selects something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    pub slot: Slot,
    pub value: i32,
}

impl Choice {
    pub fn put(&self, report: &mut [u8]) {
        self.slot.put(report, self.value);
    }
}

/// A field with a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Duration {
    slot: Slot,
    /// Time for the field's minimum, and time per count, s.
    least: f64,
    count: f64,
}

impl Duration {
    /// The count for a time (s), or for the next longer one, and the time of that count. 0 and the largest
    /// count are avoided: some devices take them for endless.
    fn nearest(&self, time: f64) -> (i32, f64) {
        let Slot { minimum, maximum, .. } = self.slot;
        // Rounding must not make the time one count longer.
        let counts = ((time - self.least) / self.count - 1e-6).ceil();
        let value = (f64::from(minimum) + counts) as i32;
        let value = value.max(minimum.max(1)).min(maximum - 1);
        (value, self.least + (f64::from(value) - f64::from(minimum)) * self.count)
    }

    /// Puts a time (s) into a report, or the nearest possible one.
    pub fn put(&self, report: &mut [u8], time: f64) {
        self.slot.put(report, self.nearest(time).0);
    }
}

/// A report: its number, and its length in bytes including the number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Form {
    pub number: u8,
    pub length: usize,
}

/// Positions of all fields in use.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Report and position of each axis, and of the buttons.
    pub axes: [Option<(u8, Slot)>; AXES],
    pub buttons: Vec<(u8, Slot)>,
    /// Features that request a new effect and return its index.
    pub create: Form,
    pub create_constant: Choice,
    pub load: Form,
    pub load_index: Slot,
    pub load_success: Choice,
    /// Parameters of an effect.
    pub effect: Form,
    pub effect_index: Slot,
    pub effect_constant: Option<Choice>,
    pub duration: Duration,
    pub gain: Option<Slot>,
    pub trigger: Option<Slot>,
    /// Flags of the axes along which an effect acts.
    pub enabled: [Option<Slot>; AXES],
    /// Magnitude of a constant force.
    pub force: Form,
    pub force_index: Slot,
    pub magnitude: Slot,
    /// Start of an effect.
    pub operation: Form,
    pub operation_index: Slot,
    pub start: Choice,
    pub loops: Option<Slot>,
    /// Control of the device as a whole, if it has one.
    pub control: Option<Control>,
    pub device_gain: Option<(Form, Slot)>,
}

/// Commands to the device as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Control {
    pub form: Form,
    pub enable: Choice,
    pub stop: Choice,
}

/// All fields of one type of report, each with its report.
struct Fields<'a>(Vec<(Form, &'a ReportField)>);

impl<'a> Fields<'a> {
    fn of(reports: &'a [Report]) -> Self {
        let mut fields = Vec::new();
        for report in reports {
            let number = report.report_id.and_then(|number| u8::try_from(u32::from(number)).ok());
            let Some(number) = number else { continue };
            let form = Form { number, length: 1 + report.size_in_bits.div_ceil(8) };
            if form.length <= LONGEST_HID_REPORT {
                fields.extend(report.fields.iter().map(|field| (form, field)));
            }
        }
        Self(fields)
    }

    /// The fields within a collection of the PID page.
    fn within(&self, collection: u16) -> Self {
        let inside = |field: &ReportField| {
            let collections: &[ReportCollection] = match field {
                ReportField::Variable(field) => &field.member_of,
                ReportField::Array(field) => &field.member_of,
                ReportField::Padding(_) => &[],
            };
            collections.iter().any(|known| is(&known.usage, PID, collection))
        };
        Self(self.0.iter().filter(|(_, field)| inside(field)).copied().collect())
    }

    /// The variable field (one that is not an array) with a usage.
    fn variable(&self, page: u16, usage: u16) -> Option<(Form, &'a VariableField)> {
        self.0.iter().find_map(|(form, field)| match field {
            ReportField::Variable(field) if is(&field.usage, page, usage) => Some((*form, field)),
            _ => None,
        })
    }

    /// The integer field with a usage.
    fn slot(&self, page: u16, usage: u16) -> Option<(Form, Slot)> {
        let (form, field) = self.variable(page, usage)?;
        Some((form, slot_of(field)?))
    }

    /// The time field with a usage, in the units that the descriptor states.
    fn duration(&self, usage: u16, descriptor: &[u8]) -> Option<Duration> {
        let (_, field) = self.variable(PID, usage)?;
        let slot = slot_of(field)?;
        let (least, most) = physical_range(field, &slot, descriptor);
        let second = seconds(field, descriptor);
        // The ends of the logical range stand for those of the physical one, linearly between.
        let counts = f64::from(slot.maximum) - f64::from(slot.minimum);
        Some(Duration { slot, least: least * second, count: (most - least) / counts * second })
    }

    /// The choice with a usage: its index in an array, or a flag of its own.
    fn choice(&self, usage: u16) -> Option<(Form, Choice)> {
        let wanted = u32::from(PID) << 16 | u32::from(usage);
        self.0.iter().find_map(|(form, field)| match field {
            ReportField::Array(field) => {
                // The index counts through all usages of the array, in the order of their ranges.
                let mut before = 0_u32;
                let range = field.usage_list.iter().find(|range| {
                    let here = range.range().contains(&wanted);
                    if !here {
                        before = before
                            .saturating_add(range.end().saturating_sub(range.start()).saturating_add(1));
                    }
                    here
                })?;
                let index = i32::try_from(before.checked_add(wanted - range.start())?).ok()?;
                let minimum = i32::from(field.logical_minimum);
                let slot = Slot::new(&field.bits, minimum, i32::from(field.logical_maximum))?;
                Some((*form, Choice { slot, value: minimum.checked_add(index)? }))
            }
            ReportField::Variable(field) if is(&field.usage, PID, usage) => {
                Some((*form, Choice { slot: Slot::new(&field.bits, 0, 1)?, value: 1 }))
            }
            _ => None,
        })
    }
}

fn is(usage: &Usage, page: u16, id: u16) -> bool {
    (usage.page(), usage.id()) == (page, id)
}

fn slot_of(field: &VariableField) -> Option<Slot> {
    Slot::new(&field.bits, i32::from(field.logical_minimum), i32::from(field.logical_maximum))
}

/// Types of descriptor items that are evaluated: their keys without the size.
mod kind {
    pub const PHYSICAL_MINIMUM: u8 = 0x34;
    pub const PHYSICAL_MAXIMUM: u8 = 0x44;
    pub const UNIT_EXPONENT: u8 = 0x54;
    pub const UNIT: u8 = 0x64;
    pub const REPORT_SIZE: u8 = 0x74;
    pub const REPORT_COUNT: u8 = 0x94;
}

/// Complete items of a descriptor: type and bytes of the value.
fn items(descriptor: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut rest = descriptor;
    std::iter::from_fn(move || {
        let [key, tail @ ..] = rest else { return None };
        // A long item states its size, and has a tag.
        let size = match (key, tail.first()) {
            (0xfe, Some(size)) => usize::from(*size) + 2,
            _ => [0, 1, 2, 4][usize::from(key & 3)],
        };
        let value = tail.get(..size)?;
        rest = &tail[size..];
        Some((key & 0xfc, value))
    })
}

/// Value of an item, read as unsigned and as signed.
fn unsigned(value: &[u8]) -> u32 {
    let mut bytes = [0; 4];
    bytes.iter_mut().zip(value).for_each(|(to, from)| *to = *from);
    u32::from_le_bytes(bytes)
}

fn signed(value: &[u8]) -> i32 {
    let unused = 32 - 8 * value.len().clamp(1, 4) as u32;
    (unsigned(value) << unused) as i32 >> unused
}

/// Whether no item asks for more or larger fields than a report holds: parsing some would exhaust memory.
fn is_bounded(descriptor: &[u8]) -> bool {
    items(descriptor).all(|(kind, value)| {
        !matches!(kind, kind::REPORT_SIZE | kind::REPORT_COUNT)
            || unsigned(value) as usize <= 8 * LONGEST_HID_REPORT
    })
}

/// Bytes of the item that was parsed to `known`: hidparser compares parsed items but does not expose their
/// values.
fn bytes_of<'a, T: PartialEq + From<&'a [u8]>>(
    known: Option<T>,
    kind: u8,
    descriptor: &'a [u8],
) -> Option<&'a [u8]> {
    let known = known?;
    items(descriptor).find(|(of, value)| *of == kind && T::from(*value) == known).map(|(_, value)| value)
}

/// Physical values at the ends of a field: the logical ones if the descriptor states nothing else.
fn physical_range(field: &VariableField, slot: &Slot, descriptor: &[u8]) -> (f64, f64) {
    let minimum: Option<PhysicalMinimum> = field.physical_minimum;
    let maximum: Option<PhysicalMaximum> = field.physical_maximum;
    let ends = bytes_of(minimum, kind::PHYSICAL_MINIMUM, descriptor)
        .zip(bytes_of(maximum, kind::PHYSICAL_MAXIMUM, descriptor))
        .map(|(least, most)| (signed(least), signed(most)))
        .filter(|(least, most)| least < most);
    let (least, most) = ends.unwrap_or((slot.minimum, slot.maximum));
    (f64::from(least), f64::from(most))
}

/// Unit of a time, s: a power of ten if the descriptor states it, else the standard's millisecond.
fn seconds(field: &VariableField, descriptor: &[u8]) -> f64 {
    let unit: Option<Unit> = field.unit;
    let exponent: Option<UnitExponent> = field.unit_exponent;
    let power =
        bytes_of(exponent, kind::UNIT_EXPONENT, descriptor).map_or(0, |value| match unsigned(value) {
            // The standard uses four bits; many devices use the whole byte.
            code @ 0..=15 => (code as i32) << 28 >> 28,
            _ => signed(value),
        });
    // Seconds to the power of one, in any system of units.
    let is_time =
        bytes_of(unit, kind::UNIT, descriptor).is_some_and(|value| unsigned(value) & 0xffff_fff0 == 0x1000);
    if power == 0 && !is_time { 1e-3 } else { 10_f64.powi(power) }
}

impl Layout {
    /// Reads a device's report descriptor; the error names what it lacks if it is not that of a force
    /// feedback device with constant forces.
    pub fn parse(descriptor: &[u8]) -> Result<Self, String> {
        if !is_bounded(descriptor) {
            return Err(format!("a report of more than {LONGEST_HID_REPORT} bytes"));
        }
        let parsed = parse_report_descriptor(descriptor).map_err(|error| format!("{error:?}"))?;
        let input = Fields::of(&parsed.input_reports);
        let output = Fields::of(&parsed.output_reports);
        let feature = Fields::of(&parsed.features);
        let lacks = |what: &'static str| move || format!("it lacks {what}");
        let slot_of = |fields: &Fields, usage: u16, what| fields.slot(PID, usage).ok_or_else(lacks(what));
        let choice_of = |fields: &Fields, usage: u16, what| fields.choice(usage).ok_or_else(lacks(what));

        let buttons = input.0.iter().filter_map(|(form, field)| match field {
            ReportField::Variable(field) if field.usage.page() == BUTTON => {
                Some((form.number, Slot::new(&field.bits, 0, 1)?))
            }
            _ => None,
        });
        // Usages of the PID page, by their names in the standard: 0xab Create New Effect Report, 0x26 ET
        // Constant Force, 0x89 PID Block Load Report with 0x22 Effect Block Index and 0x8c Block Load
        // Success.
        let (create, create_constant) = choice_of(&feature.within(0xab), 0x26, "new constant forces")?;
        let loads = feature.within(0x89);
        let (load, load_index) = slot_of(&loads, 0x22, "the index of a new effect")?;
        let (_, load_success) = choice_of(&loads, 0x8c, "the success of a new effect")?;
        // 0x21 Set Effect Report, with 0x50 Duration, 0x52 Gain, 0x53 Trigger Button and 0x55 Axes Enable.
        let effects = output.within(0x21);
        let (effect, effect_index) = slot_of(&effects, 0x22, "the index of an effect")?;
        let duration = effects.duration(0x50, descriptor).ok_or_else(lacks("the duration of an effect"))?;
        let (_, lasts) = duration.nearest(EFFECT_DURATION);
        if lasts.is_nan() || lasts < MIN_EFFECT_DURATION {
            return Err(format!(
                "its effects last {:.1} ms at most, and {:.0} ms are needed",
                1e3 * lasts,
                1e3 * MIN_EFFECT_DURATION
            ));
        }
        let enabled = effects.within(0x55);
        // 0x73 Set Constant Force Report, with 0x70 Magnitude.
        let forces = output.within(0x73);
        let (force, magnitude) = slot_of(&forces, 0x70, "the magnitude of a constant force")?;
        let (_, force_index) = slot_of(&forces, 0x22, "the index of a constant force")?;
        // 0x77 Effect Operation Report, with 0x79 Op Effect Start and 0x7c Loop Count.
        let operations = output.within(0x77);
        let (operation, start) = choice_of(&operations, 0x79, "the start of an effect")?;
        let (_, operation_index) = slot_of(&operations, 0x22, "the index of the effect to start")?;
        // 0x97 DC Enable Actuators and 0x99 DC Stop All Effects; 0x7e Device Gain.
        let control = output.choice(0x97).zip(output.choice(0x99));
        let field = |fields: &Fields, usage| fields.slot(PID, usage).map(|(_, slot)| slot);
        let layout = Self {
            axes: AXIS_USAGES.map(|usage| input.slot(DESKTOP, usage).map(|(form, slot)| (form.number, slot))),
            buttons: buttons.take(BUTTONS).collect(),
            create,
            create_constant,
            load,
            load_index,
            load_success,
            effect,
            effect_index,
            effect_constant: effects.choice(0x26).map(|(_, choice)| choice),
            duration,
            gain: field(&effects, 0x52),
            trigger: field(&effects, 0x53),
            enabled: AXIS_USAGES.map(|usage| enabled.slot(DESKTOP, usage).map(|(_, slot)| slot)),
            force,
            force_index,
            magnitude,
            operation,
            operation_index,
            start,
            loops: field(&operations, 0x7c),
            control: control.map(|((form, enable), (_, stop))| Control { form, enable, stop }),
            device_gain: output.slot(PID, 0x7e),
        };
        if layout.axes.iter().flatten().next().is_none() {
            return Err("it lacks axes".into());
        }
        if layout.enabled.iter().flatten().next().is_none() {
            return Err("it lacks forces along its axes".into());
        }
        if layout.magnitude.minimum >= 0 || layout.magnitude.maximum <= 0 {
            return Err("its constant forces have one sign only".into());
        }
        Ok(layout)
    }
}
