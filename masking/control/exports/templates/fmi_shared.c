/* What FMI 2.0 and FMI 3.0 have in common. */

static @FMI@Status get(@COMPONENT@ c, const @FMI@ValueReference vr[], size_t count, double values[])
{
    for (size_t i = 0; i < count; i++) {
        const double *found = variable(&((component_t *)c)->instance, vr[i]);
        if (found == NULL) {
            return fail(c, "@FMI@Get@REAL@: there is no variable of this value reference");
        }
        values[i] = *found;
    }
    return @FMI@OK;
}

static @FMI@Status put(@COMPONENT@ c, const @FMI@ValueReference vr[], size_t count, const double values[])
{
    for (size_t i = 0; i < count; i++) {
        const char *message = set(&((component_t *)c)->instance, vr[i], values[i]);
        if (message != NULL) {
            return fail(c, message);
        }
    }
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@SetDebugLogging(@COMPONENT@ c, @FMI@Boolean on, size_t count, const @FMI@String categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@ExitInitializationMode(@COMPONENT@ c)
{
    begin(&((component_t *)c)->instance);
    ((component_t *)c)->instance.is_initialized = 1;
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@Terminate(@COMPONENT@ c)
{
    (void)c;
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@Reset(@COMPONENT@ c)
{
    component_t *component = c;
    memset(&component->instance, 0, sizeof(component->instance));
    begin(&component->instance);
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@Get@STATE@(@COMPONENT@ c, @FMI@@STATE@ *state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(instance_t));
    }
    if (*state == NULL) {
        return fail(c, "@FMI@Get@STATE@: there is no memory left");
    }
    memcpy(*state, &((component_t *)c)->instance, sizeof(instance_t));
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@Set@STATE@(@COMPONENT@ c, @FMI@@STATE@ state)
{
    memcpy(&((component_t *)c)->instance, state, sizeof(instance_t));
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@Free@STATE@(@COMPONENT@ c, @FMI@@STATE@ *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@Serialized@STATE@Size(@COMPONENT@ c, @FMI@@STATE@ state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(instance_t);
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@Serialize@STATE@(@COMPONENT@ c, @FMI@@STATE@ state, @FMI@Byte bytes[], size_t size)
{
    if (size < sizeof(instance_t)) {
        return fail(c, "@FMI@Serialize@STATE@: the state is longer than the array");
    }
    memcpy(bytes, state, sizeof(instance_t));
    return @FMI@OK;
}

EXPORT @FMI@Status @FMI@@DESERIALIZE@@STATE@(@COMPONENT@ c, const @FMI@Byte bytes[], size_t size, @FMI@@STATE@ *state)
{
    if (size != sizeof(instance_t)) {
        return fail(c, "@FMI@@DESERIALIZE@@STATE@: the bytes are no state of this FMU");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(instance_t));
    }
    if (*state == NULL) {
        return fail(c, "@FMI@@DESERIALIZE@@STATE@: there is no memory left");
    }
    memcpy(*state, bytes, sizeof(instance_t));
    return @FMI@OK;
}
