//! `terrain.set`: changes a setting, or says why it can't.

use super::settings::{SETTABLE, Settable};
use super::{TERRAIN_SET_METHOD, TerrainRemoteError, TerrainSetting};
use bevy::ecs::reflect::AppTypeRegistry;
use bevy::prelude::*;
use bevy::reflect::serde::{TypedReflectDeserializer, TypedReflectSerializer};
use bevy::reflect::{GetPath, ParsedPath, PartialReflect, TypeInfo, TypeRegistry};
use bevy::remote::{BrpError, BrpResult};
use serde::Deserialize;
use serde::de::DeserializeSeed;
use serde_json::Value;

/// How many entities a message names at most.
const NAMED: usize = 16;
/// How many characters of what a client sent a message repeats at most.
const REPEATED: usize = 60;

/// What `terrain.set` takes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Parameters {
    #[serde(default)]
    entity: Option<u64>,
    component: String,
    path: String,
    value: Value,
}

/// The method.
pub(super) fn set(In(parameters): In<Option<Value>>, world: &mut World) -> BrpResult {
    let setting = change(parameters, world)?;
    serde_json::to_value(setting).map_err(BrpError::internal)
}

fn change(
    parameters: Option<Value>,
    world: &mut World,
) -> Result<TerrainSetting, TerrainRemoteError> {
    let Parameters {
        entity,
        component,
        path,
        value,
    } = read_parameters(parameters)?;
    let settable = find(&component)?;
    let entity = owner(settable, entity, world)?;
    let Some(old) = (settable.read)(world, entity) else {
        let remedy = "add the plugin that it belongs to".to_owned();
        return Err(TerrainRemoteError::not_there(entity, settable.name, remedy));
    };
    let registry = world.resource::<AppTypeRegistry>().clone();
    let registry = registry.read();
    let old_value = read_part(settable, &*old, &path, &registry)?;
    let Some(mut new) = (settable.read)(world, entity) else {
        let remedy = "ask again".to_owned();
        return Err(TerrainRemoteError::not_there(entity, settable.name, remedy));
    };
    write_part(settable, &mut *new, &path, &value, &old_value, &registry)?;
    let new_value = read_part(settable, &*new, &path, &registry)?;

    let owner = entity.and_then(|entity| world.get_entity(entity).ok());
    // What was wrong before isn't this value's fault.
    let before = (settable.faults)(&*old, &*old, owner);
    let mut faults = (settable.faults)(&*new, &*old, owner);
    faults.retain(|fault| !before.contains(fault));
    if !faults.is_empty() {
        return Err(TerrainRemoteError::Refused(faults.join("; ")));
    }
    (settable.write)(world, entity, new);
    Ok(TerrainSetting {
        entity,
        component: settable.name.to_owned(),
        path,
        old: old_value,
        new: new_value,
    })
}

fn read_parameters(parameters: Option<Value>) -> Result<Parameters, TerrainRemoteError> {
    let unreadable = |cause: &str| TerrainRemoteError::Parameters {
        method: TERRAIN_SET_METHOD,
        cause: shortened(cause, 2 * REPEATED),
        wanted: "an object with `component`, `path`, `value` and, where there are several, \
                 `entity`",
    };
    let parameters = parameters.unwrap_or_default();
    // serde would take the fields by their order.
    if parameters.is_array() {
        return Err(unreadable("they are a list"));
    }
    serde_json::from_value(parameters).map_err(|error| unreadable(&error.to_string()))
}

fn find(component: &str) -> Result<&'static Settable, TerrainRemoteError> {
    // Bevy's own methods use the whole path of a type.
    let name = match component.strip_prefix("bevy_tessera::") {
        Some(path) => path.rsplit("::").next().unwrap_or(path),
        None => component,
    };
    let settable = SETTABLE.iter().find(|settable| settable.name == name);
    settable.ok_or_else(|| {
        let known: Vec<_> = SETTABLE.iter().map(|settable| settable.name).collect();
        TerrainRemoteError::UnknownComponent {
            name: shortened(component, REPEATED),
            known: known.join(", "),
        }
    })
}

/// Whose settings are meant; `None` for what belongs to no entity.
fn owner(
    settable: &Settable,
    named: Option<u64>,
    world: &mut World,
) -> Result<Option<Entity>, TerrainRemoteError> {
    let component = settable.name;
    let Some(owners) = settable.owners else {
        return match named {
            None => Ok(None),
            Some(_) => Err(TerrainRemoteError::NoEntityWanted { component }),
        };
    };
    let owners = owners(world);
    let list = || {
        let first = owners.iter().take(NAMED);
        let mut list: Vec<_> = first.map(|&owner| shown(owner, world)).collect();
        if owners.len() > NAMED {
            list.push("…".to_owned());
        }
        list.join(", ")
    };
    let Some(bits) = named else {
        return match owners[..] {
            [owner] => Ok(Some(owner)),
            [] => Err(TerrainRemoteError::NotThere {
                who: "no entity".to_owned(),
                component,
                remedy: "insert one first, for instance with `world.insert_components`".to_owned(),
            }),
            _ => Err(TerrainRemoteError::Ambiguous {
                component,
                count: owners.len(),
                entities: list(),
            }),
        };
    };
    let entity = Entity::try_from_bits(bits).filter(|&entity| world.get_entity(entity).is_ok());
    let entity = entity.ok_or(TerrainRemoteError::UnknownEntity { entity: bits })?;
    if owners.contains(&entity) {
        return Ok(Some(entity));
    }
    let remedy = if owners.is_empty() {
        "insert one first, for instance with `world.insert_components`".to_owned()
    } else {
        format!("name one of {}", list())
    };
    Err(TerrainRemoteError::not_there(
        Some(entity),
        component,
        remedy,
    ))
}

/// An entity as it is sent, with its name.
fn shown(entity: Entity, world: &World) -> String {
    let bits = entity.to_bits();
    match world.get::<Name>(entity) {
        Some(name) => format!("{bits} ({})", shortened(name, REPEATED)),
        None => bits.to_string(),
    }
}

/// The part of `settings` that `path` leads to.
fn part<'a>(
    settable: &Settable,
    settings: &'a mut dyn Reflect,
    path: &str,
) -> Result<&'a mut dyn PartialReflect, TerrainRemoteError> {
    let info = settings.get_represented_type_info();
    let unknown = |cause: String| TerrainRemoteError::UnknownPath {
        component: settable.name,
        path: shortened(path, REPEATED),
        cause: shortened(&cause, 2 * REPEATED),
        known: info.map_or_else(String::new, parts),
    };
    let parsed = ParsedPath::parse(path).map_err(|error| unknown(error.to_string()))?;
    settings.reflect_path_mut(&parsed).map_err(|error| {
        let text = error.to_string();
        // Which access it was is what the path says.
        let cause = text.split_once("): ").map_or(&*text, |(_, cause)| cause);
        unknown(cause.to_owned())
    })
}

fn read_part(
    settable: &Settable,
    settings: &dyn Reflect,
    path: &str,
    registry: &TypeRegistry,
) -> Result<Value, TerrainRemoteError> {
    let not_plain = || TerrainRemoteError::NotPlain {
        setting: setting_name(settable, path),
    };
    let mut copy = settings.reflect_clone().map_err(|_| not_plain())?;
    let part = part(settable, &mut *copy, path)?;
    serde_json::to_value(TypedReflectSerializer::new(part, registry)).map_err(|_| not_plain())
}

fn write_part(
    settable: &Settable,
    settings: &mut dyn Reflect,
    path: &str,
    value: &Value,
    now: &Value,
    registry: &TypeRegistry,
) -> Result<(), TerrainRemoteError> {
    let part = part(settable, settings, path)?;
    let info = part.get_represented_type_info();
    let wrong = |cause: String| TerrainRemoteError::WrongType {
        setting: setting_name(settable, path),
        value: shortened(&value.to_string(), REPEATED),
        cause: shortened(&cause, 2 * REPEATED),
        wanted: info.map_or_else(
            || "another value".to_owned(),
            |info| wanted(info, now, registry),
        ),
    };
    let registration = info
        .and_then(|info| registry.get(info.type_id()))
        .ok_or_else(|| TerrainRemoteError::NotPlain {
            setting: setting_name(settable, path),
        })?;
    let new = TypedReflectDeserializer::new(registration, registry)
        .deserialize(value)
        .map_err(|error| wrong(error.to_string()))?;
    part.try_apply(&*new)
        .map_err(|error| wrong(error.to_string()))
}

fn setting_name(settable: &Settable, path: &str) -> String {
    if path.is_empty() {
        settable.name.to_owned()
    } else {
        format!("{}::{}", settable.name, shortened(path, REPEATED))
    }
}

/// What paths there are, one level deep.
fn parts(info: &TypeInfo) -> String {
    match info {
        TypeInfo::Struct(fields) => fields.field_names().join(", "),
        _ => "an empty path".to_owned(),
    }
}

/// What a value of a type looks like in JSON, of which there is one `now`.
fn wanted(info: &'static TypeInfo, now: &Value, registry: &TypeRegistry) -> String {
    let has_own_form = registry
        .get_type_data::<ReflectDeserialize>(info.type_id())
        .is_some();
    match info {
        // What its fields are says nothing of how such a value is written.
        TypeInfo::Struct(_) | TypeInfo::TupleStruct(_) | TypeInfo::Enum(_)
            if has_own_form && !now.is_null() =>
        {
            format!("a value like {}", shortened(&now.to_string(), 2 * REPEATED))
        }
        TypeInfo::Struct(fields) => {
            format!("an object with some of {}", fields.field_names().join(", "))
        }
        TypeInfo::Enum(variants) if info.type_path().starts_with("core::option::Option<") => {
            let inner = variants.variant("Some").and_then(|some| {
                let some = some.as_tuple_variant().ok()?;
                some.field_at(0)?.type_info()
            });
            format!(
                "null or {}",
                inner.map_or_else(
                    || "a value".to_owned(),
                    |inner| wanted(inner, now, registry)
                )
            )
        }
        TypeInfo::Enum(variants) => {
            let names = variants.iter().map(|variant| {
                let name = variant.name();
                match variant.as_struct_variant() {
                    Ok(fields) => {
                        format!(
                            "{{\"{name}\": {{{}: …}}}}",
                            fields.field_names().join(": …, ")
                        )
                    }
                    Err(_) if variant.as_tuple_variant().is_ok() => format!("{{\"{name}\": …}}"),
                    Err(_) => format!("\"{name}\""),
                }
            });
            names.collect::<Vec<_>>().join(" or ")
        }
        TypeInfo::Array(array) => format!("a list of {}", array.capacity()),
        _ => match info.type_path() {
            "f32" | "f64" => "a number".to_owned(),
            "bool" => "true or false".to_owned(),
            path if path.starts_with(['u', 'i']) => "a whole number in its range".to_owned(),
            path => format!("a {}", path.rsplit("::").next().unwrap_or(path)),
        },
    }
}

/// The beginning of a text that came from outside.
fn shortened(text: &str, characters: usize) -> String {
    match text.char_indices().nth(characters) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}
