/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* What the wrappers of FMI 2.0 and 3.0 share. The file that includes it defines STATUS, INSTANCE, REFERENCE, OK and
 * refuse.
 */
#define NOTHING_TO_DO(name)                                                                                            \
    STATUS name(INSTANCE c)                                                                                            \
    {                                                                                                                  \
        (void)c;                                                                                                       \
        return OK;                                                                                                     \
    }

/* What a sampled law or plant does not have. */
#define MISSING(name, ...)                                                                                             \
    STATUS name(INSTANCE c, __VA_ARGS__)                                                                               \
    {                                                                                                                  \
        return refuse(c, #name " is not offered by this FMU");                                                         \
    }

/* Variables of another type than double: there are none. */
#define NO_VARIABLES(name, ...)                                                                                        \
    STATUS name(INSTANCE c, const REFERENCE vr[], size_t count, __VA_ARGS__)                                           \
    {                                                                                                                  \
        (void)vr;                                                                                                      \
        return count ? refuse(c, "all variables are numbers of double precision") : OK;                               \
    }

static STATUS get_numbers(INSTANCE c, const REFERENCE vr[], size_t count, double value[])
{
    for (size_t i = 0; i < count; i++)
        if (!model_get((const model_t *)c, vr[i], value + i))
            return refuse(c, "there is no variable of this value reference");
    return OK;
}

static STATUS set_numbers(INSTANCE c, const REFERENCE vr[], size_t count, const double value[])
{
    for (size_t i = 0; i < count; i++)
        if (!model_set((model_t *)c, vr[i], value[i]))
            return refuse(c, "the variable cannot be set, or the value is out of its range");
    return OK;
}

static STATUS advance(INSTANCE c, double step)
{
    if (!model_advance((model_t *)c, step))
        return refuse(c, "the communication step must be above 0 s, and at most 1e9 sample periods");
    return OK;
}

static STATUS reset(INSTANCE c)
{
    model_reset((model_t *)c);
    return OK;
}

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
